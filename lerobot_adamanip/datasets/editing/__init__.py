"""New datasets out of the episodes of others: chosen, parted and put together, with everything that tells of them."""
