"""Options and paths that the command lines of ``o2mon`` and ``o2train`` share."""
