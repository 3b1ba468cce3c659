"""Two papers reproduced: their tables and figures, measured and drawn again."""
