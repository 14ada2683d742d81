"""Least squares fits of the constants of the chain and of effects."""
