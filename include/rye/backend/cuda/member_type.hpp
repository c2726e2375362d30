// SPDX-License-Identifier: Apache-2.0
/// rye/backend/cuda/member_type.hpp: types that only some devices have, as members of types for all
/// devices.
#pragma once

namespace rye::detail {

/// Replaces a type that a device does not have.
struct NoSuchType {};

template <class D, template <class> class M>
struct MemberTypeOf {
    using type = NoSuchType;
};
template <class D, template <class> class M>
    requires requires { typename M<D>; }
struct MemberTypeOf<D, M> {
    using type = M<D>;
};

/// M<D>, which names a type of D, or NoSuchType where D has none of that name.
template <class D, template <class> class M>
using MemberType = typename detail::MemberTypeOf<D, M>::type;

} // namespace rye::detail
