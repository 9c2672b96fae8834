"""What vat_mart, adaafford and sampling share: networks, options, plans, contact labels."""
