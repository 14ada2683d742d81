"""Text logs of frames: whole lines in chunks, checks of lines, and python-can's readers."""
