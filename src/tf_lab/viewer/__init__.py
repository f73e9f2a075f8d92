"""Looking at reconstructions in the browser: sessions that know no page, and the page."""
