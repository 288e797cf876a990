"""Objects: built-in stand-ins, imported meshes, and what is derived from them."""
