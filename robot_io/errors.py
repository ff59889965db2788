"""The one family of errors: each says the value, the place and the valid choices in one line."""


class PalpateError(Exception):
    """Base of every error that palpate raises on purpose; its text is one line that a user can act on."""


class InputError(PalpateError, ValueError):
    """Something the user supplied (file, option, value) is not valid; the command line exits with 2."""


class UnknownNameError(InputError, KeyError):
    """A name that a registry does not hold; also a `KeyError`, so that mappings behave as such."""

    __str__ = InputError.__str__  # KeyError would show the message in quotes


class DeviceError(PalpateError):
    """A device or its bus failed."""


class DeviceTimeoutError(DeviceError, TimeoutError):
    """A device did not answer before its deadline."""


class ProtocolError(DeviceError):
    """What came over a wire is not what its protocol allows; nothing of it was believed."""


class LifecycleError(PalpateError):
    """A call came in the wrong state, such as a command to a robot that is not active."""


class SafetyTripError(PalpateError):
    """A limit was exceeded; the guard is latched until it is re-armed."""


class SessionError(InputError):
    """A session file cannot be written, or what was read is not a whole session."""
