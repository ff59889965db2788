"""What a person looks at: Rerun recordings and plots made from a session."""
