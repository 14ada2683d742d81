"""Judge the recordings of a fleet on the cores of this machine or on a Dask cluster."""

from monitor.frames.text.python_can import import_without_mdf

import_without_mdf()  # in every worker, too: 1 s of each start
