"""Parts of figures: panels, curves over time, paths in space, and the style of all of them."""
