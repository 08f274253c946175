"""Scenes made by code, each a function of a random generator."""
