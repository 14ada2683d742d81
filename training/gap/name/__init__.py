"""Which effect explains the gap, and whether one may say so."""
