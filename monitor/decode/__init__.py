"""Step 2: frames become values, by a database and a signal map."""
