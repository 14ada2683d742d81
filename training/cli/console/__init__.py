"""Progress of long commands on the console."""
