"""What commands do, apart from their options: demo, import preview, merge, paired comparison, resolve."""
