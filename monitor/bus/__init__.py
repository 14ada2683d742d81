"""The bus of the live loop: received from, sent to, watched, recorded; and its time."""
