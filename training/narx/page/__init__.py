"""What a fit says of itself: verdict, figures, page."""
