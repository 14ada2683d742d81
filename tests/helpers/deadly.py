"""A job that may kill the process that does it."""

import os
import time


def job(shared: int, item: int) -> int:
    """Add two numbers; a negative item kills the process."""
    if item < 0:
        time.sleep(0.2)  # so that the one before it is done
        os._exit(9)
    return shared + item
