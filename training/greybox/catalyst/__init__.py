"""Grey-box model of a catalyst and the switching sensor behind it, and its fit."""
