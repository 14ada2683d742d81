"""Why a recording was not judged: counts over its samples, and the conditions that failed."""
