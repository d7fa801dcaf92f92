"""Methods that read a run's sensor streams, and what scores them against its truth."""
