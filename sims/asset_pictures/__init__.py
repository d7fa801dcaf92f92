"""Pictures of reconstructed things, drawn without a graphics card, and the page that shows them."""
