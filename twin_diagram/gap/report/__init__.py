"""What was found, for people and for programs: the page, its charts, and gap.json."""
