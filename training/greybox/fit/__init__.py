"""Drives, and least-squares fits of the chain's constants and of effects to them."""
