"""The one exception a user is meant to see."""


class InputError(Exception):
    """Bad input or usage: one line that says what is wrong, where, and what to do.

    The command line prints the message to stderr and exits with code 2; library
    callers may catch it. Its text must not contain a newline.
    """
