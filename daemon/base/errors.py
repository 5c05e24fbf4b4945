"""Errors that a person can put right."""


class UserError(Exception):
    """Bad input: one sentence with the place and the remedy; the command line ends with exit code 2."""
