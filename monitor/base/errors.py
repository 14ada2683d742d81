"""Errors that a user can cause. Each ends a command with exit code 2.

O2Error
├── UsageError        the command line asks for something impossible
├── ConfigError       a TOML file has an unknown key or an impossible value
├── SignalMapError    a CAN database and a signal map do not fit each other
├── RecordingError    a log or table cannot be read
│   └── MissingSignalsError  it lacks signals that the model needs
│       └── CoarseTableError its rows are further apart than the samples of the model
├── ModelError        a model file has no card, or its card and graph disagree
└── BusError          a CAN interface cannot be opened or has failed

A message says in one line where the error is, which value came and which was wanted.
"""


class O2Error(Exception):
    """Base of all errors that a command reports as one line without a traceback."""


class UsageError(O2Error):
    """The command line asks for something impossible."""


class ConfigError(O2Error):
    """A configuration file has an unknown key or an impossible value."""


class SignalMapError(O2Error):
    """A CAN database or signal map is unusable, or they do not fit each other."""


class RecordingError(O2Error):
    """A log or table cannot be read, or lacks needed signals."""


class MissingSignalsError(RecordingError):
    """A recording lacks signals that the model needs."""


class CoarseTableError(MissingSignalsError):
    """A table has its rows further apart than the model's samples."""


class ModelError(O2Error):
    """A model file has no card, or its card and graph disagree."""


class BusError(O2Error):
    """A CAN interface cannot be opened or has failed."""
