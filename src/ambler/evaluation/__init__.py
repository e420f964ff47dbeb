"""How good it was: trajectory errors, map quality, statistics, results files and reports."""
