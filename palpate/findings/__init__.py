"""Names under which palpate.text and palpate.views still look for things; goes with them."""
