"""What people open: a map, points for the web, a page that tells what happened."""
