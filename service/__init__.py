"""The REST service around :mod:`pcdnf`: an API process, a worker process and a durable queue between them.

The API process never imports torch and never parses an upload; see ``docs/api.md``.
"""
