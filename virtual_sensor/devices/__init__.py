"""What stands in a scene and sees or shines: a ray family with its radiometry, plain data."""
