// A site that is opened from disk cannot fetch its own pages, so search results have titles without excerpts. State this on the search page.
function noteOnSearch() {
  const results = document.getElementById("search-results");
  if (results && window.location.protocol === "file:") {
    const note = document.createElement("p");
    note.textContent =
      "This site is opened from disk: results show titles only. For excerpts, serve the folder: python -m http.server --directory build/site";
    results.before(note);
  }
}

// On a narrow screen a figure keeps a legible size and scrolls by itself.
function scrollFigures() {
  for (const image of document.querySelectorAll(".bd-article img")) {
    if (image.naturalWidth > 640 && !image.closest(".sphx-glr-thumbcontainer, .sd-card, .figure-scroll")) {
      const frame = document.createElement("div");
      frame.className = "figure-scroll";
      image.before(frame);
      frame.append(image);
    }
  }
}

document.addEventListener("DOMContentLoaded", noteOnSearch);
window.addEventListener("load", scrollFigures);
