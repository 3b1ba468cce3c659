"""What a motion keeps clear of, and how far it is from it."""
