"""SyncTwin's experiments with ray-cast pictures and the truth that scores them: for benchmarks alone."""
