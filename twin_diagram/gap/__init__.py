"""Where simulation and measurement part ways, and which effect of the catalogue is missing."""
