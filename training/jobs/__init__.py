"""Jobs on several processes or machines, and folders of a run that can be resumed."""

from collections.abc import Callable

Progress = Callable[[str], None]  # called with a line of text
