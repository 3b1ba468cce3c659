"""What a person sees: plots and replays."""
