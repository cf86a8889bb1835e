"""The routes, one module for each group of rows of the HTTP table."""
