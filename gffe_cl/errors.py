"""The one exception users meet."""


class GffeError(Exception):
    """A structural fault in what the caller gave: bad file, size, camera, device, option.

    The message is one line that says what is wrong, where, and what was expected. The command line
    prints it and exits with code 2. Bad *pixels* never raise it, except in strict mode.
    """
