"""The live bus: the loop that judges it, and the attachments of the loop."""
