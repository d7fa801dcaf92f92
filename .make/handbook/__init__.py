"""Makes the handbook in `docs/` ready to read: what is made of the code, pictures, notebooks, HTML."""
