"""How results are shown: one style for pictures, one set of templates for pages, one table."""
