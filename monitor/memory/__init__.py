"""Step 9: trouble codes, driving cycles, the reference of the vehicle, and their store."""
