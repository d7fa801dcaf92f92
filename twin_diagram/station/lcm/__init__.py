"""A real arm behind Drake's own LCM messages, and a fake one at the other end of the bus."""
