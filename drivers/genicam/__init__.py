"""What every camera with a GenICam node map has in common, whichever library the node map comes from."""
