"""Ray-cast and real tabletops for the benchmarks of segmentation."""
