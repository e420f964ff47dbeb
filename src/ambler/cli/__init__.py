"""The command line: one file per verb. `main` collects them; heavy imports happen only inside the verb that runs."""
