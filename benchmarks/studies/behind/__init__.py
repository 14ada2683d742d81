"""The catalyst matrix: what is said behind the catalyst on many simulated drives."""
