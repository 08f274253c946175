"""The API process: HTTP, and nothing that computes or parses a cloud."""
