"""Built-in plugins; each is seen exactly as an outsider's is."""
