"""Benchmarks, fuzzers and studies: ``python -m benchmarks`` lists them, with a NAME it runs one.

A benchmark is a module with ``main(argv) -> int`` in a folder for its question. Its options are
``outcome.BenchmarkOptions``; its rows go to ``outcome.finish``, which prints the table, writes the
JSON and fails if nothing was measured. The tests run its form ``--smallest``.
"""
