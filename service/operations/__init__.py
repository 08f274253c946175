"""The commands of an operator: serve, doctor, drain."""
