"""What a run looks like: meshcat and its recordings, Meldis, the Diagram as a picture, plots."""
