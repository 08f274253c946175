"""The job database: its tables, its engine, its upgrades."""
