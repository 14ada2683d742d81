"""OBD-II polling, for vehicles that broadcast no useful signals."""
