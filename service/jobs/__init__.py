"""Jobs as rows of the database: the API and the workers meet here."""
