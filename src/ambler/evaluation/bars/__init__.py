"""The rows of the tables of results with their bars, by what they judge; `row` is what they are made of, `evaluation/results_table.py` puts them together."""
