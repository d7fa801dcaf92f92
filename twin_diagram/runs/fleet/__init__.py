"""`twin-diagram gap` on many robots: what each of them lacks, and since when."""
