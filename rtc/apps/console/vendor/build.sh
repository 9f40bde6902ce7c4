#!/bin/sh
# Bundle three and CodeMirror into one file, with the licences of all packages in it. Needs npm; run it after a change of
# entry.js or package.json, and commit the two files that it writes.
set -eu
cd "$(dirname "$0")"
npm install --no-audit --no-fund --no-package-lock --silent
npx esbuild entry.js --bundle --minify --format=esm --target=es2022 --legal-comments=none --outfile=../static/vendor.js
{
  echo "vendor.js contains these packages, bundled and minified; all have the MIT licence."
  for package in three @codemirror/autocomplete @codemirror/commands @codemirror/language @codemirror/lint \
    @codemirror/state @codemirror/view @lezer/common @lezer/highlight @lezer/lr @marijn/find-cluster-break crelt style-mod \
    w3c-keyname; do
    version=$(node -p "require('./node_modules/$package/package.json').version")
    printf '\n== %s %s\n\n' "$package" "$version"
    cat "node_modules/$package/LICENSE"
  done
} >../static/vendor-licences.txt
rm -rf node_modules
