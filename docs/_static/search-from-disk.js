// A page that is opened from disk cannot fetch other pages, so search results have titles without excerpts. State this on the search page.
document.addEventListener("DOMContentLoaded", () => {
  const results = document.getElementById("search-results");
  if (results && window.location.protocol === "file:") {
    const note = document.createElement("p");
    note.textContent =
      "This site is opened from disk: results show titles only. For excerpts, serve the folder: python -m http.server --directory build/site";
    results.before(note);
  }
});
