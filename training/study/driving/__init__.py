"""How the driving that trains a model changes what it can do."""
