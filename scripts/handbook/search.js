// The search of the handbook, without a server: the index is a script, as pages that are files may not fetch one.
"use strict";
{
  const list = document.getElementById("mkdocs-search-results"), field = document.getElementById("mkdocs-search-query");
  const words = (text) => text.toLowerCase().split(/[^\p{L}\p{N}]+/u).filter(Boolean);
  const loaded = (name) =>
    new Promise((resolve, reject) => {
      const script = document.createElement("script");
      Object.assign(script, { src: `${base_url}/search/${name}`, onload: resolve, onerror: reject });
      document.head.append(script);
    });
  const excerpt = (text, terms) => {
    const found = Math.max(0, text.toLowerCase().search(new RegExp(terms.join("|"))));
    const from = Math.max(0, found - 80);
    return `${from ? "… " : ""}${text.slice(from, found + 160)} …`;
  };
  const show = (index, sections, pages) => {
    const terms = words(field.value);
    // the word itself counts more than words that it begins
    const found = !terms.length ? [] : index.query((query) => {
      for (const term of terms) {
        query.term(term, { boost: 10, usePipeline: true });
        query.term(term, { wildcard: lunr.Query.wildcard.TRAILING, usePipeline: false });
      }
    });
    const all = found.filter((one) => Object.keys(one.matchData.metadata).length >= terms.length);
    list.replaceChildren(...(all.length ? all : found).slice(0, 50).map(({ ref }) => {
      const section = sections.get(ref), entry = document.createElement("article");
      const head = document.createElement("h3"), link = document.createElement("a"), text = document.createElement("p");
      const page = pages.get(ref.split("#")[0]);
      Object.assign(link, { href: `${base_url}/${ref}`, textContent: page === section.title ? page : `${page}: ${section.title}` });
      head.append(link);
      text.textContent = excerpt(section.text, terms);
      entry.append(head, text);
      return entry;
    }));
    if (!found.length) list.textContent = terms.length ? `No section has ${field.value}.` : "Type what you look for.";
  };
  if (list)
    loaded("lunr.js").then(() => loaded("sections.js")).then(() => {
      const sections = new Map(handbook.map((one) => [one.location, one]));
      const pages = new Map(handbook.filter((one) => !one.location.includes("#")).map((one) => [one.location, one.title]));
      lunr.tokenizer.separator = /[^\p{L}\p{N}]+/u;
      const index = lunr(function () {
        this.ref("location");
        this.field("title", { boost: 20 });
        this.field("text");
        handbook.forEach((one) => this.add(one));
      });
      field.value = new URLSearchParams(location.search).get("q") ?? "";
      field.addEventListener("input", () => show(index, sections, pages));
      show(index, sections, pages);
    });
}
