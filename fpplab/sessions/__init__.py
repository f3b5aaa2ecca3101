"""Sessions: measurements as directories; loose images into sessions, and sessions played back as devices."""
