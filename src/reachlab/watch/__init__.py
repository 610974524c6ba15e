"""What people look at: plots, videos and the page."""
