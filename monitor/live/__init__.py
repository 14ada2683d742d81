"""The live page: what the loop sees, in a browser, in a process of its own."""
