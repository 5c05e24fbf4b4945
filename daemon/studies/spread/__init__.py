"""The tasks of a study, spread over processes or machines, with the same results as in one process."""
