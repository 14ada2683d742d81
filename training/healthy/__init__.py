"""The behaviour of the healthy vehicle, the yardstick of every score, kept in a model's card."""
