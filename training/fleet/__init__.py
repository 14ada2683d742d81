"""A fleet's recordings, judged on this machine's cores or on a Dask cluster."""
