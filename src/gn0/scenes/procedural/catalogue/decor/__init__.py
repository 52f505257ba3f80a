"""What makes a flat a home: plants, vases, pictures, mirrors, clocks, curtains, radiators."""
