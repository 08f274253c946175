"""The REST service around :mod:`pcdnf`: an API process, a worker process and a durable queue between them.

The API process imports no torch and parses no uploads; see ``docs/api.md``.
"""
