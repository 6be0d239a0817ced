"""A drive log cut, split and weighted for fits; declared vehicle and tyres."""
