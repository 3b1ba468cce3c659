"""What stands below the replay in a report: plots tied to its time, tables, texts."""
