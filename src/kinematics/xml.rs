//! Reading XML that comes from outside: bounds first, then the parser.

use roxmltree::{Document, ParsingOptions};

/// Longest accepted text (bytes).
pub const MAX_XML_BYTES: usize = 4 << 20;
/// Most accepted nodes of one document.
pub const MAX_XML_NODES: u32 = 200_000;
/// Most accepted attributes of one document.
const MAX_XML_ATTRIBUTES: usize = 400_000;
/// Longest accepted tag (bytes): the parser compares the attributes of one element pair by pair.
const MAX_TAG_BYTES: usize = 64 << 10;
/// Deepest accepted nesting: the parser calls itself for each level.
const MAX_DEPTH: usize = 128;
/// Most accepted namespace declarations: the parser copies them from element to element.
const MAX_NAMESPACES: usize = 64;

/// Why a text was not accepted as XML.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum XmlError {
    /// More bytes, nodes, attributes or namespaces than accepted.
    #[error("the XML is too large: more than {limit} {what}")]
    TooLarge {
        /// What there is too much of.
        what: &'static str,
        /// How much of it is accepted.
        limit: usize,
    },
    /// It has a document type declaration.
    #[error("the XML has a document type declaration (DTD), which is not accepted; remove it")]
    DocumentType,
    /// It is not well formed.
    #[error("the XML is not well formed: {0}")]
    Broken(String),
}

/// Parses `text` with document types off and every size bounded.
///
/// # Errors
/// [`XmlError`] when the text is too large, has a DTD or is not well formed.
pub(super) fn parse_xml(text: &str) -> Result<Document<'_>, XmlError> {
    check_sizes(text)?;
    let options = ParsingOptions { allow_dtd: false, nodes_limit: MAX_XML_NODES };
    Document::parse_with_options(text, options).map_err(|error| match error {
        roxmltree::Error::DtdDetected => XmlError::DocumentType,
        roxmltree::Error::NodesLimitReached => {
            XmlError::TooLarge { what: "nodes", limit: MAX_XML_NODES as usize }
        }
        other => XmlError::Broken(other.to_string()),
    })
}

/// Bounds what the parser would allocate or compare, before it starts.
fn check_sizes(text: &str) -> Result<(), XmlError> {
    if text.len() > MAX_XML_BYTES {
        return Err(XmlError::TooLarge { what: "bytes", limit: MAX_XML_BYTES });
    }
    let count = |byte: u8| text.bytes().filter(|b| *b == byte).count();
    // An element has an opening and a closing tag.
    if count(b'<') > 2 * MAX_XML_NODES as usize {
        return Err(XmlError::TooLarge { what: "nodes", limit: MAX_XML_NODES as usize });
    }
    if count(b'=') > MAX_XML_ATTRIBUTES {
        return Err(XmlError::TooLarge { what: "attributes", limit: MAX_XML_ATTRIBUTES });
    }
    check_structure(text)
}

/// Bounds what would cost the parser more than time in proportion to the text: namespaces, long
/// tags, deep nesting.
///
/// # Errors
/// [`XmlError::TooLarge`].
pub(super) fn check_structure(text: &str) -> Result<(), XmlError> {
    if text.matches("xmlns").take(MAX_NAMESPACES + 1).count() > MAX_NAMESPACES {
        return Err(XmlError::TooLarge { what: "namespaces", limit: MAX_NAMESPACES });
    }
    check_tags(text)
}

/// Bounds the length and the nesting of tags.
fn check_tags(text: &str) -> Result<(), XmlError> {
    let mut depth = 0_usize;
    let mut rest = text;
    while let Some(start) = rest.find('<') {
        let tag = &rest[start..];
        let until = |end: &str| tag.find(end).map_or(tag.len(), |at| at + end.len());
        let length = if tag.starts_with("<!--") {
            until("-->")
        } else if tag.starts_with("<![CDATA[") {
            until("]]>")
        } else if tag.starts_with("<?") {
            until("?>")
        } else {
            let length = tag_length(tag)?;
            if tag.starts_with("</") {
                depth = depth.saturating_sub(1);
            } else if !tag[..length].ends_with("/>") {
                depth += 1;
            }
            length
        };
        if depth > MAX_DEPTH {
            return Err(XmlError::TooLarge { what: "levels of nesting", limit: MAX_DEPTH });
        }
        rest = &tag[length..];
    }
    Ok(())
}

/// The bytes from `<` to the `>` that ends the tag, which is not one within quotes.
fn tag_length(tag: &str) -> Result<usize, XmlError> {
    let mut quote = None;
    for (at, byte) in tag.bytes().enumerate().take(MAX_TAG_BYTES) {
        match (quote, byte) {
            (None, b'>') => return Ok(at + 1),
            (None, b'"' | b'\'') => quote = Some(byte),
            (Some(open), _) if open == byte => quote = None,
            _ => {}
        }
    }
    if tag.len() > MAX_TAG_BYTES {
        return Err(XmlError::TooLarge { what: "bytes in one tag", limit: MAX_TAG_BYTES });
    }
    Ok(tag.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn document_types_are_refused() {
        let text = r#"<?xml version="1.0"?><!DOCTYPE r [<!ENTITY a "aaaa">]><r>&a;</r>"#;
        assert_eq!(parse_xml(text).err(), Some(XmlError::DocumentType));
    }

    #[test]
    fn deep_nesting_and_many_attributes_end_in_an_error() {
        let deep = |level: &str| format!("{}{}", level.repeat(150_000), "</a>".repeat(150_000));
        for level in ["<a>", "<a b='/>'>", "<a b=\"'\" c='/>'>", "<a><!-- </a> -->", "<a><![CDATA[</a>]]>"] {
            let text = &deep(level)[..level.len() * 150_000];
            assert!(matches!(parse_xml(text), Err(XmlError::TooLarge { .. })), "{level}");
        }
        let flat = format!("<r>{}</r>", "<a b='>'></a>".repeat(10_000));
        assert!(parse_xml(&flat).is_ok());
        let attributes: String = (0..100_000).map(|i| format!(" a{i}=\"\"")).collect();
        assert!(matches!(parse_xml(&format!("<r{attributes}/>")), Err(XmlError::TooLarge { .. })));
        let namespaces: String = (0..100).map(|i| format!("<a xmlns:n{i}='u'>")).collect();
        assert!(matches!(parse_xml(&namespaces), Err(XmlError::TooLarge { what: "namespaces", .. })));
    }
}
