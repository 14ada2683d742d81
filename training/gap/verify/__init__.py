"""Old and new model on recordings that no fit saw."""
