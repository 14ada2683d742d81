"""The monitor as C for a controller: the same verdicts, from the same model and settings."""
