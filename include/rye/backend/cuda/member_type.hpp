// SPDX-License-Identifier: Apache-2.0
/// rye/backend/cuda/member_type.hpp: types that some devices have and others have not, as members
/// of what is written for both.
#pragma once

namespace rye {

/// In the place of a type that a device has not.
struct NoSuchType {};

namespace detail {

template <class D, template <class> class M>
struct MemberTypeOf {
    using type = NoSuchType;
};
template <class D, template <class> class M>
    requires requires { typename M<D>; }
struct MemberTypeOf<D, M> {
    using type = M<D>;
};

} // namespace detail

/// M<D>, which names a type of D, or NoSuchType where D has none of that name.
template <class D, template <class> class M>
using MemberType = typename detail::MemberTypeOf<D, M>::type;

} // namespace rye
