"""The kinds of models that ``o2train fit`` fits beside the network."""
