"""What a run of learning is scored by: the true world, which no stage of it sees."""
