"""What only a simulation knows: the tables of its engine, and what its catalyst lets pass."""
