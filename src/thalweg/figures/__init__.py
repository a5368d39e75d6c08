"""Pictures for people: pure functions of result tables and arrays. The only room that imports matplotlib."""
