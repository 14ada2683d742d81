"""Judge the recordings of a fleet on the cores of this machine or on a Dask cluster."""
