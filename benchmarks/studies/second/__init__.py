"""A second engine and catalyst, written apart from the dynamometer and from every model."""
