"""HTML pages of every report."""
