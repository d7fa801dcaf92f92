"""Objects with hidden loads on a simulated arm, and the truth that scores their weighing: for benchmarks alone."""
