"""How results look: one style for pictures, one set of templates for pages, one kind of table."""
