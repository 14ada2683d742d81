"""Benchmarks, fuzzers and studies: ``python -m benchmarks`` lists them, with a NAME it runs one."""
