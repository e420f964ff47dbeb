"""From raw scans, clouds and pictures to what algorithms take: merging, filtering, ground, markers, reflectors, glass."""
