"""The API process: HTTP only, with no computation and no parsing of clouds."""
