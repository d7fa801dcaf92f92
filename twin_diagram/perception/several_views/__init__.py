"""Several cameras that look at one set of objects: what each remembers, and how what they show becomes one."""
