"""The errors a user can cause; every one ends a command with exit code 2.

O2Error
├── UsageError        the command line asks for something that cannot be
├── ConfigError       a TOML file has an unknown key or an impossible value
├── SignalMapError    a DBC or signal map does not fit
├── RecordingError    a log or table cannot be read
├── ModelError        a model file is not ours, or its card and graph disagree
└── BusError          a CAN interface cannot be opened or has failed

A message says where, what came and what was wanted, in one line.
"""


class O2Error(Exception):
    """Base of all errors that are reported as one line, without a traceback."""


class UsageError(O2Error):
    """The command line asks for something that cannot be."""


class ConfigError(O2Error):
    """A configuration file has an unknown key or an impossible value."""


class SignalMapError(O2Error):
    """A CAN database or signal map is unusable, or the two do not fit each other."""


class RecordingError(O2Error):
    """A log or table cannot be read, or lacks what is needed."""


class ModelError(O2Error):
    """A model file is not ours, or its card and graph disagree."""


class BusError(O2Error):
    """A CAN interface cannot be opened or has failed."""
