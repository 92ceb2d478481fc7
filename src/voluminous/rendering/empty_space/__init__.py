"""What rays may leap over: blocks and leaves that show nothing."""
