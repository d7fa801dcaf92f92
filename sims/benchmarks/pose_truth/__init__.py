"""Things on a table before a camera with noise, ray-cast, with the truth that scores poses: for benchmarks alone."""
