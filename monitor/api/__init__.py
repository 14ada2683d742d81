"""The public Python API of the runtime; ``monitor`` offers its names, each imported on first use.

It does what ``o2mon`` does: ``verdict`` holds the result, ``recordings`` judges drives on disk
or in arrays, ``stream`` judges frames one by one, ``listener`` does so on a bus of python-can.
"""
