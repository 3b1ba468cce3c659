"""When what happens: phases, holds, via points, lengths of steps."""
