"""From images to poses: clouds, segments, registration, and the two systems that carry them."""
