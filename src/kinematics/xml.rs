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
    if text.matches("xmlns").take(MAX_NAMESPACES + 1).count() > MAX_NAMESPACES {
        return Err(XmlError::TooLarge { what: "namespaces", limit: MAX_NAMESPACES });
    }
    let mut rest = text;
    while let Some(start) = rest.find('<') {
        let tag = &rest[start..];
        let length = if tag.starts_with("<!--") {
            tag.find("-->").map_or(tag.len(), |end| end + 3)
        } else {
            let length = tag.find('>').map_or(tag.len(), |end| end + 1);
            if length > MAX_TAG_BYTES {
                return Err(XmlError::TooLarge { what: "bytes in one tag", limit: MAX_TAG_BYTES });
            }
            length
        };
        rest = &tag[length..];
    }
    Ok(())
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
        let deep = "<a>".repeat(300_000);
        assert!(parse_xml(&deep).is_err());
        let well_formed = format!("{}{}", "<a>".repeat(150_000), "</a>".repeat(150_000));
        assert!(parse_xml(&well_formed).is_ok());
        let attributes: String = (0..100_000).map(|i| format!(" a{i}=\"\"")).collect();
        assert!(matches!(parse_xml(&format!("<r{attributes}/>")), Err(XmlError::TooLarge { .. })));
        let namespaces: String = (0..100).map(|i| format!("<a xmlns:n{i}='u'>")).collect();
        assert!(matches!(parse_xml(&namespaces), Err(XmlError::TooLarge { what: "namespaces", .. })));
    }
}
