"""The tasks of a study spread over processes or machines: the same results as in one process, whoever worked."""
