"""Stands before asammdf where nobody reads .mf4: ``import can`` then takes a tenth of its time."""

raise ModuleNotFoundError(f"{__name__} is hidden, see guest.py", name=__name__)
